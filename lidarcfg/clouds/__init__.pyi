from .cloud import PointCloud as PointCloud
from .cloud import concatenate as concatenate
from .cloud import load_cloud as load_cloud
from .cloud import save_clouds as save_clouds
from .las import load_las as load_las
from .las import save_las as save_las
